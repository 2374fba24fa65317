"""The two ends of the CAN bus: the plant (valve board rules and twin) and the sequencer (controllers).

`plant_node` and `sequencer_node` are the ends themselves, frames in and frames out. `lockstep` joins them in one
process on simulated time; `wall_clock` runs either as a process of its own on any bus. `run.run_scene` runs any scene.
"""
