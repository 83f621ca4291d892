"""Files of the sorties: strips, images, trajectories, records."""
