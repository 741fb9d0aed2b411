"""Recording protocol, corpus readers and batch measurement."""
