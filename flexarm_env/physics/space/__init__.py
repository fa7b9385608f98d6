"""The geometrically exact beam in space (Simo 1985; Simo & Vu-Quoc 1986): chains of links with joints about any axis.

`rotations` defines vectors, matrices and quaternions, `element` the forces and tangent of an element, `equations` the
chain. Floating frames (`frame`, `framed`) and links with strains as coordinates (`strained`) use the same chain.
"""
