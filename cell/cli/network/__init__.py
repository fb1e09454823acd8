"""Commands about cells and operators on other machines: the fleet, the router, certificates."""
