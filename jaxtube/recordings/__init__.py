"""Records of real robots: files of logs, windows and paths, read to numbers with their units."""
