"""Only what pyproject.toml cannot say: the cffi module is compiled at build time."""

from setuptools import setup

setup(cffi_modules=["host/native/build.py:ffibuilder"])
