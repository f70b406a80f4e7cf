"""Other people's files: what comes in from other tools, and what goes out to them.

`png_dataset` makes a data set of a folder of PNG maps, as other projects publish them, and such a folder of a data set;
`conventions` says how each project draws its maps. `split_file` writes what a method elsewhere may know of a split;
`score_file` reads, checks, scores and records the predictions that come back.
"""
