"""Results against the truth of a simulated campaign: the only rooms that open truth/."""
