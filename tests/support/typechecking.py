"""The type checker that jaxtyping runs under pytest: beartype, with an int accepted as a float."""

from beartype import BeartypeConf, beartype

typechecker = beartype(conf=BeartypeConf(is_pep484_tower=True))
