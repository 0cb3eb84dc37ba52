"""A host's radio: what it broadcasts to all robots, and the Crazyradio that does it."""
