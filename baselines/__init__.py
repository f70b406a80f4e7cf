"""The built-in methods, one a file, found through the entry-point group `xfreqbench.methods`.

In come training rows, a budget and a seed; predicted maps come out. README.md says how to write a method and what each
of these keeps and changes of its paper.
"""
