"""The independent specification of every format: construct and crcmod, and nothing that the C code uses.

It repeats each constant and shares none, so that a mistake in one of the two shows in tests/protocol. The tables of
docs/PROTOCOL.md are made from it (python -m host.protocol.spec.tables docs/PROTOCOL.md).
Names of fields are those of the C structs. A construct accepts exactly the bytes that the C decoder accepts.
"""
