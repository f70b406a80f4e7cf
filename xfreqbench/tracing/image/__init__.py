"""Solver `image`: the exact image method in float64, for scenes of planar facets of which not too many mirror.

`tracer` prepares arrays for the compiled `kernels`: the facets in a tree of boxes (`surfaces`), the sequences of
mirrors that can matter (`sequences`), and the edges at which waves diffract (`edges`, `diffraction`).
"""
