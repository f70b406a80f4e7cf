"""Compiled kernels of the image method, in float64, one subject a file.

`compiled` says how they are compiled and cached, `arrays` what they are given. `tree` builds a tree of boxes and looks
up what a segment meets, `bundles` follows paths through a scene, `sequences` finds the mirrors that a path may turn
at, `slabs` and `fields` carry a wave along a path, and `channels` sums paths. `wedges`, `edge_sides` and `edge_paths`
do the same for paths over one edge.
"""
