"""The archive of 10.3: packed, listed, checked."""
