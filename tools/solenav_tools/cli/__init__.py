"""The `solenav` command: one thin module per subcommand."""
