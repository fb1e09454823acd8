"""The PackML state machine, who may command it, and the gate that every motion passes."""
