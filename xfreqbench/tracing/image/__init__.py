"""Solver `image`: the exact image method in float64, for scenes of up to some 400 planar facets.

In come a scene, its geometry and carriers; out go channels and paths. `tracer` prepares arrays for the compiled
`kernels` and calls them.
"""
