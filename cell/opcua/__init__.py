"""The cell over OPC UA, as a PackML machine. It needs the package asyncua, which only `cell opcua` imports."""
