"""One time step, what comes before the first and after a jump, and the books."""
