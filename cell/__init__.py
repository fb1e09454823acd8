"""The cell: the pick, the state machine, the nodes' supervision, the daemon and the command line."""
