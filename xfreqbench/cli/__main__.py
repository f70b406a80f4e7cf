"""Lets `python -m xfreqbench.cli` run the command line."""

from xfreqbench.cli.main import main

main()
