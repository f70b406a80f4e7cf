"""Commands that write, disturbed at random: killed, doubled, on full disks, among damaged, linked and foreign files.

The command line comes in, as a function; what is wrong after a round comes out. After each disturbance the same command
is given once more, undisturbed. It must leave the bytes that it leaves where nothing happens, or refuse in words, and
whatever lies outside its output must be as it was.
"""
