"""Numerical stability as a list of named cases, one file for each subject, run by `xfreqbench bench stress`.

A case is a function that returns one error, decorated with its name, limit and unit. Nothing comes in; a verdict
for each case comes out.

Each case compares the code with a reference that shares no code with it. References take only data from the code
under test: the speed of light, the constants of P.2040's table, the positions of array elements and the directions
of the grid; references for slabs also take the permittivity, which has cases of its own. What ordinary tests
hold, such as scores, seeds and threads, is no case here.

Closed forms of phase are computed in long double, which has 80 bits on x86. Where NumPy's long double is a double
(Windows, Macs with ARM), the references round as the code under test does, and a case may err by twice as much.
"""
