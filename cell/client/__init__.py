"""The client of a running cell in another process: state, commands, results. `connect` opens one."""

from cell.client.connection import Client, connect
from cell.client.leads_to import LEADS_TO, RUNS_AGAIN
from cell.client.names import client_name

__all__ = ["LEADS_TO", "RUNS_AGAIN", "Client", "client_name", "connect"]
