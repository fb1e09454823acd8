"""Commands that run a cell in this process, and serve it to others: ``start``, ``tour``, ``http``, ``opcua``."""
