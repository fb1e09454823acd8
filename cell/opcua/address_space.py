"""Builds the nodes of the tables: PackML's types and states, and below Objects the one machine, ``Cell``."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from asyncua import Node, Server, ua
from asyncua.server.event_generator import EventGenerator

from cell.opcua import packml
from cell.opcua.methods import METHODS, Argument, Method
from cell.opcua.structures import add_structures
from cell.opcua.variables import EVENTS, OBJECTS, PROPERTIES, VARIABLES, Variable

NAMESPACE = "urn:vlad-cell:opcua"
_MACHINES = (packml.BASE_STATE_MACHINE, packml.MACHINE_STATE, packml.EXECUTE_STATE)
_ZERO: dict[str, tuple[Any, ua.VariantType]] = {
    "String": ("", ua.VariantType.String),
    "Boolean": (False, ua.VariantType.Boolean),
    "Int32": (0, ua.VariantType.Int32),
    "Enumeration": (packml.PRODUCE, ua.VariantType.Int32),
    "Float": (0.0, ua.VariantType.Float),
    "Double": (0.0, ua.VariantType.Double),
    "DateTime": (datetime(1601, 1, 1, tzinfo=UTC), ua.VariantType.DateTime),
    "NodeId": (ua.NodeId(), ua.VariantType.NodeId),
}


class AddressSpace:
    """The nodes of one cell, and what writes them.

    Attributes:
        packml, ours: indices of the two namespaces.
        methods: by method and object, the method that a call means.
    """

    def __init__(self, server: Server, packml_index: int, our_index: int) -> None:
        self._server, self.packml, self.ours = server, packml_index, our_index
        self.methods: dict[ua.NodeId, Method] = {}
        self.callable_on: set[ua.NodeId] = set()
        self._events: dict[str, EventGenerator] = {}
        self._kinds = {variable.path: variable.kind for variable in VARIABLES}

    def node_id(self, path: str) -> ua.NodeId:
        """Return the id of ``Cell.`` and the path below it; of the cell's own object for ""."""
        return ua.NodeId(f"Cell.{path}" if path else "Cell", self.ours)

    def name(self, name: str, *, is_packml: bool) -> ua.QualifiedName:
        """A browse name in PackML's namespace or in ours."""
        return ua.QualifiedName(name, self.packml if is_packml else self.ours)

    async def write(self, values: Mapping[str, Any]) -> None:
        """Write variables by their path, one after the other."""
        for path, value in values.items():
            kind = self._kinds[path]
            await self._write(self.node_id(path), ua.Variant(value, _variant_type(kind)))

    async def write_current_states(self, states: Mapping[str, str | None]) -> None:
        """Write ``CurrentState`` and its ``Id`` of the three nested machines."""
        for machine, state in states.items():
            node = self.node_id(f"{machine}.CurrentState")
            text = ua.LocalizedText(state) if state is not None else ua.LocalizedText()
            where = ua.NodeId(packml.node_of(state), self.packml) if state is not None else ua.NodeId()
            await self._write(node, ua.Variant(text, ua.VariantType.LocalizedText))
            await self._write(self.node_id(f"{machine}.CurrentState.Id"), ua.Variant(where, ua.VariantType.NodeId))

    async def _write(self, node: ua.NodeId, variant: ua.Variant) -> None:
        await self._server.write_attribute_value(node, ua.DataValue(variant, SourceTimestamp=datetime.now(UTC)))

    async def tell(self, kind: str, text: str, severity: int, fields: Mapping[str, str]) -> None:
        """Send an event of one of our types. ``severity``: OPC UA's, 1 to 1000."""
        generator = self._events[kind]
        generator.event.Severity = severity
        for name, value in fields.items():
            setattr(generator.event, name, value)
        await generator.trigger(message=text or kind)

    # --- building -----------------------------------------------------------------------------------------------------

    async def build(self, cell_id: str) -> None:
        """Add every node."""
        await self._add_types()
        objects = self._server.nodes.objects
        cell = await self._add_object(objects, "", "Cell", "PackMLBaseObjectType", is_packml=False)
        parents = {"": cell}
        for name, kind in OBJECTS.items():
            parents[name] = await self._add_object(cell, name, name, kind, is_packml=bool(kind))
        for variable in VARIABLES:
            await self._add_variable(parents[variable.path.rpartition(".")[0]], variable)
        await self._add_machines(cell)
        await self._add_methods(cell)
        await self._add_events(cell)
        modes = ua.NodeId(packml.MODES, self.packml)
        await self.write({"TagID": cell_id, "PackMLVersion": "TR88.00.02-2015", "Status.UnitSupportedModes": modes})
        await self.write({"Status.UnitModeCurrent": packml.PRODUCE, "Admin.StopReasonExtent": 1})

    async def _add_types(self) -> None:
        await add_structures(self._server, self.packml)
        enumeration = self._server.get_node(ua.NodeId(ua.ObjectIds.Enumeration))
        modes = next(name for name, node in packml.DATA_TYPES.items() if node == packml.MODES)
        await enumeration.add_data_type(ua.NodeId(packml.MODES, self.packml), self.name(modes, is_packml=True))
        machine_type = self._server.get_node(ua.NodeId(ua.ObjectIds.FiniteStateMachineType))
        types = {}
        for name, number in packml.OBJECT_TYPES.items():
            parent = machine_type if "StateMachine" in name else self._server.nodes.base_object_type
            types[name] = await parent.add_object_type(ua.NodeId(number, self.packml), self.name(name, is_packml=True))
        states = {**{state.value: node for state, node in packml.STATES.items()}, **packml.OUTER_STATES}
        for state, node in states.items():
            of = types[packml.MACHINE_TYPES[node.machine]]
            added = await self._add_typed(
                of,
                ua.NodeId(node.node, self.packml),
                self.name(state, is_packml=True),
                ua.NodeId(ua.ObjectIds.StateType),
            )
            number = ua.Variant(node.number, ua.VariantType.UInt32)
            await added.add_property(
                ua.NodeId(node.number_node, self.packml), ua.QualifiedName("StateNumber", 0), number
            )

    async def _add_object(self, parent: Node, path: str, name: str, kind: str, *, is_packml: bool) -> Node:
        type_id = ua.NodeId(packml.OBJECT_TYPES[kind], self.packml) if kind else ua.NodeId(ua.ObjectIds.BaseObjectType)
        return await self._add_typed(parent, self.node_id(path), self.name(name, is_packml=is_packml), type_id)

    async def _add_typed(self, parent: Node, node: ua.NodeId, name: ua.QualifiedName, kind: ua.NodeId) -> Node:
        """Add an object that names its type, without what asyncua would put below it under numbers of its own."""
        is_root = parent == self._server.nodes.objects
        item = ua.AddNodesItem()
        item.RequestedNewNodeId, item.BrowseName, item.ParentNodeId = node, name, parent.nodeid
        item.ReferenceTypeId = ua.NodeId(ua.ObjectIds.Organizes if is_root else ua.ObjectIds.HasComponent)
        item.NodeClass, item.TypeDefinition = ua.NodeClass.Object, kind
        attributes = ua.ObjectAttributes()
        attributes.DisplayName = attributes.Description = ua.LocalizedText(name.Name)
        attributes.EventNotifier = attributes.WriteMask = attributes.UserWriteMask = 0
        item.NodeAttributes = attributes
        (result,) = await self._server.iserver.isession.add_nodes([item])
        result.StatusCode.check()
        return self._server.get_node(node)

    async def _add_variable(self, parent: Node, variable: Variable) -> None:
        name = self.name(variable.path.rpartition(".")[2], is_packml=variable.is_packml)
        add = parent.add_property if variable.path in PROPERTIES else parent.add_variable
        node = await add(self.node_id(variable.path), name, *self._first_value(variable.kind))
        described = ua.DataValue(ua.Variant(ua.LocalizedText(variable.meaning), ua.VariantType.LocalizedText))
        await node.write_attribute(ua.AttributeIds.Description, described)
        if variable.kind.endswith("[]"):
            rank = ua.DataValue(ua.Variant(1, ua.VariantType.Int32))
            await node.write_attribute(ua.AttributeIds.ValueRank, rank)

    def _first_value(self, kind: str) -> tuple[Any, ua.VariantType, ua.NodeId | None]:
        """Value, variant type and data type of a new variable."""
        one = kind.removesuffix("[]")
        structure = {"Count": packml.COUNT, "Alarm": packml.ALARM, "Enumeration": packml.MODES}.get(one)
        data_type = ua.NodeId(structure, self.packml) if structure is not None else None
        if one in ("Count", "Alarm"):
            made = ua.get_type(data_type)()
            return [made] if kind.endswith("[]") else made, ua.VariantType.ExtensionObject, data_type
        value, variant_type = _ZERO[one]
        return [] if kind.endswith("[]") else value, variant_type, data_type or ua.NodeId(variant_type.value)

    async def _add_machines(self, cell: Node) -> None:
        """Add the three state machines, each inside the one before."""
        parent, parents = cell, {}
        for name in _MACHINES:
            parent = parents[name] = await self._add_object(
                parent, name, name, packml.MACHINE_TYPES[name], is_packml=True
            )
            current = await parent.add_variable(
                self.node_id(f"{name}.CurrentState"), ua.QualifiedName("CurrentState", 0), ua.LocalizedText()
            )
            await current.add_property(
                self.node_id(f"{name}.CurrentState.Id"), ua.QualifiedName("Id", 0), ua.NodeId(), ua.VariantType.NodeId
            )
        self.callable_on = {cell.nodeid, *(node.nodeid for node in parents.values())}

    async def _add_methods(self, cell: Node) -> None:
        """Add the methods to the cell's object, and to the state machines that declare them in the specification."""
        for method in METHODS:
            machine, number = packml.METHODS.get(method.name, ("", 0))
            inputs, outputs = ([_argument(one) for one in side] for side in (method.inputs, method.outputs))
            node = await cell.add_method(
                self.node_id(method.name), self.name(method.name, is_packml=bool(number)), _not_here, inputs, outputs
            )
            self.methods[node.nodeid] = method
            if number:
                on = self._server.get_node(self.node_id(machine))
                await on.add_reference(node, ua.ObjectIds.HasComponent, forward=True, bidirectional=False)
                declared = self._server.get_node(
                    ua.NodeId(packml.OBJECT_TYPES[packml.MACHINE_TYPES[machine]], self.packml)
                )
                await declared.add_method(
                    ua.NodeId(number, self.packml), self.name(method.name, is_packml=True), _not_here, inputs, outputs
                )
                self.methods[ua.NodeId(number, self.packml)] = method

    async def _add_events(self, cell: Node) -> None:
        for kind, fields in EVENTS.items():
            made = await self._server.create_custom_event_type(
                self.ours, kind, ua.ObjectIds.BaseEventType, [(name, ua.VariantType.String) for name in fields]
            )
            self._events[kind] = await self._server.get_event_generator(made, emitting_node=cell)


def _variant_type(kind: str) -> ua.VariantType:
    one = kind.removesuffix("[]")
    return ua.VariantType.ExtensionObject if one in ("Count", "Alarm") else _ZERO[one][1]


def _argument(argument: Argument) -> ua.Argument:
    described = ua.LocalizedText(argument.meaning)
    kind = ua.NodeId(getattr(ua.ObjectIds, argument.kind))
    return ua.Argument(Name=argument.name, DataType=kind, ValueRank=-1, ArrayDimensions=[], Description=described)


async def _not_here(_object: ua.NodeId, *_arguments: ua.Variant) -> ua.StatusCode:
    """Never called: the session answers every method of the cell itself (`cell.opcua.sessions`)."""
    return ua.StatusCode(ua.StatusCodes.BadNotImplemented)
