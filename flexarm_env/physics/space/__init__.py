"""The geometrically exact beam in space (Simo 1985; Simo & Vu-Quoc 1986): chains of links with joints about any axis.

`rotations` has vectors, matrices and quaternions, `element` one element's forces and tangent, `equations` the chain.
Floating frames (`frame`, `framed`) and links with strains as coordinates (`strained`) share the chain.
"""
