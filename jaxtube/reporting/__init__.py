"""Reports as pages: one HTML file that holds everything it shows, and laps that play in it."""
