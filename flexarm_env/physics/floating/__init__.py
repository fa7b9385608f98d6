"""Meek & Liu's floating frames, of finite elements or reduced to modes (theory, sections 1 to 4)."""
