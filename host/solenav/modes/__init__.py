"""Motion modes: labels, training and evaluation of the forest, thresholds for each mode."""
