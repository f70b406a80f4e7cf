"""Scene files that ship with xfreqbench: data only."""
