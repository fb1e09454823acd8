"""Subscriptions belong to the session that made them: asyncua lets every session change and end those of all others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.internal_session import InternalSession

_INVALID = ua.StatusCodes.BadSubscriptionIdInvalid


class OwnSubscriptions(InternalSession):  # type: ignore[misc]
    """A session whose subscription services answer for its own subscriptions only."""

    def _is_own(self, number: int) -> bool:
        found = self.subscription_service.subscriptions.get(number)
        return found is not None and found.session_id == self.session_id

    def _require_own(self, params: Any) -> None:
        """Raises: ServiceError for a request about another session's subscription, or none."""
        if not self._is_own(params.SubscriptionId):
            raise ServiceError(_INVALID)

    async def _of_own(self, ids: list[int], ask: Callable[[list[int]], Any]) -> list[ua.StatusCode]:
        """Return what ``ask`` answers for our own of these subscriptions, and a refusal for each other, in order."""
        own = [number for number in ids if self._is_own(number)]
        answers = iter(await ask(own))
        kept = set(own)
        return [next(answers) if number in kept else ua.StatusCode(_INVALID) for number in ids]

    async def delete_subscriptions(self, ids: list[int]) -> list[ua.StatusCode]:
        """Delete our own of these."""
        return await self._of_own(ids, super().delete_subscriptions)

    async def set_publishing_mode(self, params: ua.SetPublishingModeParameters) -> list[ua.StatusCode]:
        """Switch our own of these on or off."""
        ask = super().set_publishing_mode

        async def switch(own: list[int]) -> list[ua.StatusCode]:
            params.SubscriptionIds = own
            answers: list[ua.StatusCode] = await ask(params)
            return answers

        return await self._of_own(list(params.SubscriptionIds), switch)

    async def create_monitored_items(self, params: ua.CreateMonitoredItemsParameters) -> Any:
        """Add to a subscription of ours. Raises: ServiceError."""
        self._require_own(params)
        return await super().create_monitored_items(params)

    async def modify_monitored_items(self, params: ua.ModifyMonitoredItemsParameters) -> Any:
        """Change what a subscription of ours has. Raises: ServiceError."""
        self._require_own(params)
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(self, params: ua.DeleteMonitoredItemsParameters) -> Any:
        """Remove from a subscription of ours. Raises: ServiceError."""
        self._require_own(params)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(self, params: ua.SetMonitoringModeParameters) -> Any:
        """Change how a subscription of ours looks. Raises: ServiceError."""
        self._require_own(params)
        return await super().set_monitoring_mode(params)

    def modify_subscription(self, params: ua.ModifySubscriptionParameters) -> Any:
        """Change a subscription of ours. Raises: ServiceError."""
        self._require_own(params)
        return super().modify_subscription(params)

    def republish(self, params: ua.RepublishParameters) -> Any:
        """Send a message of ours again. Raises: ServiceError."""
        self._require_own(params)
        return super().republish(params)

    async def transfer_subscriptions(self, params: ua.TransferSubscriptionsParameters, callback: Any) -> Any:
        """Refused: a client whose session is gone subscribes anew. Raises: ServiceError."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)
