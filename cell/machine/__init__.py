"""The PackML state machine, the leases of its clients, and the gate that every motion passes."""
