"""The daemon: joins the machine, the pick and the nodes, and answers on the bus."""
