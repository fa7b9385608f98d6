"""A compiler of kernels: what the physics says of it is a dozen words (docs: compiler)."""
