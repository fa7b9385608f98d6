"""The geometrically exact beam (Simo & Vu-Quoc 1986; theory, eq. 5.1)."""
