"""Walks on simulated printers: what is done on them, and what must not happen.

What is enumerated: jobs.py (commands, each on a printer that suits it), faults.py
(every fault at every operation of each, as walks).

What is drawn: drawn/ (printers, and steps in any order).

How a walk is done: walker.py (one step after the other), doing.py (steps that are
more than one command), breaking.py (what a command has the machine do, and what
breaks meanwhile).

How it is judged: judging.py (each step, by the simulated world; strictly where a
good run is known), gaps.py (the true gap at Z=0), claims.py (what is said, and
whether it is so).

Many of them: __main__.py (the command line), running.py (on all cores, kept and
gone again, counted), tables.py (those of the documents).
"""
