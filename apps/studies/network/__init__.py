"""How good the network's functions are, beside plane waves and beside exact modes.

Data flows `methods` (subspaces) and `cases` (points and an operator) -> `accuracy` (one measured
on the other) -> `questions` (which of them, and what follows: `findings`) -> the tables of
`command`.
"""
