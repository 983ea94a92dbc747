"""What goes wrong around a command: see docs/reliability.md."""
