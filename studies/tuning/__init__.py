"""Which kp, ti and buffer suit valves of any backlash."""
