"""The `drft` command: the root in `main`, one module for each subcommand."""
