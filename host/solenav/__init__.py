"""solenav on the host: captures, engines, verification, simulation, evaluation, plots."""
