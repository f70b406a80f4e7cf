"""The field that is trained: paths over mirror images in planes, with materials, gains and a few free sources.

`images` traces the paths, `slabs`, `presence` and `gain` hold what is learned of the planes, `learned_room` joins
these, and `field` makes channels and power maps of them.
"""
