"""What all rooms use: messages, results on disk and terminal, plots, other programs."""
