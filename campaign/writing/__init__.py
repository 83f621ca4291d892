"""Files and folders that appear complete or not at all, and go on where they were stopped."""
