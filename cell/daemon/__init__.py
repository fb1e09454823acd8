"""The daemon: connects the machine, the pick and the nodes, and answers on the bus."""
