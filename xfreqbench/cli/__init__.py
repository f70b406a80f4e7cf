"""The command line: what a person types, turned into calls of the rooms below.

`main` runs it and turns errors into exit codes; `options` holds what all commands share; the other files define the
commands, by subject. Every command imports what it needs only when it runs, so that `--help` answers at once.
"""
