"""Time integration (theory, section 6): a step, its Newton iteration, starts and jumps, and the energy account."""
