"""The method `virtual-source`: it finds planes in the maps and mirrors transmitters in them, exact in phase everywhere.

`method` is what entry points name. `search` finds planes in training rows, `field` learns materials and gains of the
images in them, and `room` makes faces and furniture of what was learned, refines them and traces them for predictions.
`stored` describes what a record keeps of all that, `findings` compares it with the true scene, and `commands` brings
`xfreqbench findings` and `xfreqbench residual`. `config` holds the options.
"""
