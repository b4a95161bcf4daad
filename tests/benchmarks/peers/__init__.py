"""Speed of the evolution here against public libraries, on one core, in one run.

What is fair: every contestant evolves the same tanh perceptron, in the same float32 layout, on the same pairs,
with the same number of evaluations a generation, and its error function is checked against one oracle first. A
library enters twice: as its documentation writes such a problem, and in the fastest form that we found for it
within its own interfaces. Each library has a process of its own; one works at a time, on one and the same core.

Times are of the processor (all threads of the process), so that neighbours on a shared core do not count.
"""
