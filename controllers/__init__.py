"""Readings in, commands out: estimation, commutation, pressure loops, fault detection, recovery, sequencer.

Knows no bus and no twin.
"""
