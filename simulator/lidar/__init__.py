"""The LiDAR: scanner, radar equation, instrument, a flight's strips, and the ranging line of 9.1. Echoes: `simulator.pulses`."""
