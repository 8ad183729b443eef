"""Ayeni (1980), table 3
=====================

Thirty methods of phototriangulation: all feasible ones, on one simulated block of three strips.
The paper has figures of seven of them, each from another block.
``examples.papers.methods_1980`` describes the methods, ``methods_1980_block`` the block.
"""

from examples.papers.methods_1980 import REPORTED, run_methods
from examples.papers.methods_1980_block import simulated_block

print(run_methods(simulated_block()))
print("\nPrinted in the paper, cm:")
for number, figures in REPORTED.items():
    print(f"  {number:2}  {figures}")
