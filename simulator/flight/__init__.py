"""Where the platform is, where it believes it is, and how the sensors hang on it; frames of reference."""
