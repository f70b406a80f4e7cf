"""Examples that ship with xfreqbench: the template that `new-method` copies, and how a scene was made."""
