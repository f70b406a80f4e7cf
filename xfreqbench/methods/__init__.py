"""What a method is, and what methods are built from.

In come training maps, a budget and a seed; out comes a predictor of maps at any transmitter position and carrier.
`contract` says what a method has to offer, `registry` finds methods by name, `fitting` times their training, and
`check` tries every part of the contract. `learning` and `splatting` hold what several of the built-in methods, in
`xfreqbench.baselines`, are made of.
"""

import sys

from xfreqbench.system.callable_package import CallablePackage

NAMES = "xfreqbench.methods.registry:method_names"
sys.modules[__name__].__class__ = CallablePackage
