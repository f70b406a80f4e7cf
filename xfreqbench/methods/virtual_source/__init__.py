"""The field of the method `virtual-source`: transmitters mirrored in planes, with exact phases at every carrier.

In come training rows (`PasDataset`), then transmitters and carriers. Out come power maps, and a description of the
planes, materials and images that were learned. `search` finds planes, `images` traces paths, `slabs` and `presence`
hold what is learned about materials, `room` joins these, and `field` makes maps of them. `faces` and `surfaces` make a
room of it, `refine` changes that until it suits training rows, and `render` traces it beside the field.
"""
