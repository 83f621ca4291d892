"""What is wrong with a campaign folder, line by line, before anything is evaluated."""
