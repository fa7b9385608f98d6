"""Contact of points of an arm with obstacles: law, kernels, assembly and readings (theory, section 6, "Contact")."""
