"""Refusals as OPC UA says them: a status code, and what happened and what to do in words."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from asyncua import ua

from bus.errors import CellError
from cell.opcua.address_space import AddressSpace

_STATUS = {
    "WRONG_STATE": ua.StatusCodes.BadInvalidState,
    "TOO_LATE": ua.StatusCodes.BadInvalidState,
    "LEASE_HELD": ua.StatusCodes.BadLocked,
    "BAD_JOB": ua.StatusCodes.BadInvalidArgument,
    "BAD_PAYLOAD": ua.StatusCodes.BadInvalidArgument,
    "BAD_ARGUMENT": ua.StatusCodes.BadInvalidArgument,
    "ARGUMENT_MISSING": ua.StatusCodes.BadArgumentsMissing,
    "ARGUMENT_TOO_MANY": ua.StatusCodes.BadTooManyArguments,
    "NO_METHOD": ua.StatusCodes.BadMethodInvalid,
    "QUEUE_FULL": ua.StatusCodes.BadTooManyOperations,
    "PLACE_FULL": ua.StatusCodes.BadResourceUnavailable,
    "JOB_KNOWN": ua.StatusCodes.BadEntryExists,
    "NO_JOB": ua.StatusCodes.BadNotFound,
    "NOT_AT_REST": ua.StatusCodes.BadInvalidState,
    "PICTURE_ELSEWHERE": ua.StatusCodes.BadInvalidState,
    "NO_PROPOSAL": ua.StatusCodes.BadNotFound,
    "OTHER_PROPOSAL": ua.StatusCodes.BadInvalidArgument,
    "NO_RIGHT": ua.StatusCodes.BadUserAccessDenied,
    "UNREACHABLE_CELL": ua.StatusCodes.BadNoCommunication,
    "NO_REPLY": ua.StatusCodes.BadNoCommunication,
    "BUS": ua.StatusCodes.BadNoCommunication,
    "REPLY_TIMEOUT": ua.StatusCodes.BadTimeout,
}
STATUS_NAMES = {code: ua.StatusCode(status).name for code, status in _STATUS.items()}
"""Code -> name of the status; of any other code `OTHER`."""
OTHER = "BadRequestNotAllowed"
_WARNING = 500


class Refusals:
    """Answers calls that are refused, and tells of the last one."""

    def __init__(self, space: AddressSpace) -> None:
        self._space = space
        self._alone = asyncio.Lock()  # the variables and the event belong together

    async def answer(
        self, why: CellError, method: str, client: str, arguments: Sequence[bool] = ()
    ) -> ua.CallMethodResult:
        """Return the result of a refused call: its status, and code and words as its outputs.

        Args:
            arguments: for each input whether it was right, where one was not.
        """
        said = {"Code": why.code, "Reason": why.text, "Advice": why.advice, "Method": method, "Client": client}
        async with self._alone:
            await self._space.write({f"LastRefusal.{name}": text for name, text in said.items()})
            if why.code == "PLACE_FULL":
                await self._space.write({"Status.EquipmentBlocked": True})
            await self._space.tell("RefusalEvent", f"{method}: {why}", _WARNING, said)
        status = _STATUS.get(why.code, getattr(ua.StatusCodes, OTHER))
        mismatch = ua.StatusCode(ua.StatusCodes.BadTypeMismatch)
        return ua.CallMethodResult(
            StatusCode=ua.StatusCode(status),
            InputArgumentResults=[ua.StatusCode() if fits else mismatch for fits in arguments],
            OutputArguments=[ua.Variant(why.code), ua.Variant(str(why))],
        )
