"""The field that is trained: paths over mirror images in planes, with materials, gains and a few free sources.

`images` traces the paths, `slabs` holds what is learned of the planes, `learned_room` joins the two, and `field` makes
channels and power maps of them.
"""
