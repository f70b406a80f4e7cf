"""Shows a data set or a scene: the rooms behind `xfreqbench view` and `xfreqbench info`.

In comes a data set or a scene; `plan` reads it and traces one transmitter's rays, `summary` computes numbers for each
carrier. Out goes a folder with a page, figures and a 3D model, written by `write`, or the text of `describe`.
"""
