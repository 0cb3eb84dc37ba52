"""Firmware images: compilers, building, and what is in an image.

Nothing here knows the protocol or a port. `build.build("stm32")` is all that most callers need.
"""
