"""Files of the indoor benches and of the ranging line."""
