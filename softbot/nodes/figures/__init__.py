"""The figures of a robot under its sequencer: `softbot figure NAME`; made as those of `sim.figures`."""
