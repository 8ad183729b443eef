"""Tests. A test of `factorgraph_adj.ROOM` lies in `tests/ROOM`.

Tests of several rooms lie with the topmost of them; those against published results lie in
`published`; those of the whole repository (structure, README, examples) lie here.

What tests share lies in modules that hold no tests, since no test module imports another:
`networks` (networks with known truth), `support` (references, checks and places of files) and
`loaders` (readers of the formats of other programs). `python -m tests.benchmarks` measures.
"""
