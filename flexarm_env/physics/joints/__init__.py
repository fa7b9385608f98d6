"""Joints of an arm, for every formulation without multipliers: rotors, elastic gears, backlash and friction."""
