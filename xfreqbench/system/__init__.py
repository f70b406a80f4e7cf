"""What all other layers need of the machine: files, worker processes and clusters, and what a run was made with.

In come paths, texts and functions to call; out come files that are whole or absent, locks, results of calls, and the
names and versions of hardware, software and source code. Nothing here knows of scenes, maps or methods.
"""
