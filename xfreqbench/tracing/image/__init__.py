"""Solver `image`: the exact image method in float64, for scenes of planar facets of which not too many mirror.

In come a scene, its geometry and carriers; out go channels and paths. For few facets `tracer` prepares arrays for the
compiled `kernels`, which run in loops over planes. For furnished meshes `furnished` does, and its kernels look up in
trees what a segment meets (`box_tree`).
"""
