"""The CAN message spec (DBC), its codec, end-to-end protection, the board's safety rules, buses and traces.

Imports nothing else of this project: firmware teams can take it as it is.
"""
