"""Built-in methods, one a file; each is found through the entry-point group `xfreqbench.methods`."""
