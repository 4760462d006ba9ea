"""What people run: the `solenav` command and everything that touches a device."""
