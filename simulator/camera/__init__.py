"""The camera in flight and on the bench: where a point is seen (`view`), what the sensor makes of light, and its frames."""
