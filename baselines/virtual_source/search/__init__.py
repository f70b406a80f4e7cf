"""Search for reflecting planes in training maps; no geometry of the room is used.

In comes a `PasDataset` of training rows, and for later searches the channels explained so far. Out come `Plane`s,
strongest first, with standard deviations. `cross_terms` extracts the terms of reflections from maps, `coarse` finds
candidates, `selection` refines them and rejects false ones, and `range_profile` measures distances precisely.
"""
