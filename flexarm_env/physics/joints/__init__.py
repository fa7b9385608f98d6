"""What turns an arm's joints, for every formulation without multipliers: rotors, elastic gears, friction."""
