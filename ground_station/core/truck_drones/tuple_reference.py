"""Named tuples that compiled code receives by reference.

numba passes a named tuple as all values of its fields: eight for each array. Twenty arrays in each
call take more of the compiler's time than the code itself.
"""

from typing import Any, TypeVar

from numba.core import cgutils, types
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

NamedTupleClass = TypeVar("NamedTupleClass", bound=type[tuple])


def passed_by_reference(named_tuple_class: NamedTupleClass) -> NamedTupleClass:
    """Pass instances of this class to compiled code by reference. Compiled code can read their
    fields, nothing else.
    """

    @typeof_impl.register(named_tuple_class)
    def _type_of(instance: tuple[object, ...], context: object) -> "TupleReference | None":
        field_types = [typeof_impl(field, context) for field in instance]
        if any(field_type is None for field_type in field_types):
            return None
        return TupleReference(types.BaseTuple.from_types(field_types, type(instance)))

    return named_tuple_class


class TupleReference(types.Type):
    """Type of a reference to a named tuple in the frame of the call from Python."""

    def __init__(self, tuple_type: Any) -> None:
        self.tuple_type = tuple_type
        super().__init__(name=f"reference({tuple_type})")


@register_model(TupleReference)
class _PointerModel(models.PrimitiveModel):
    def __init__(self, data_models: Any, reference: TupleReference) -> None:
        tuple_model = data_models.lookup(reference.tuple_type)
        super().__init__(data_models, reference, tuple_model.get_value_type().as_pointer())


@infer_getattr
class _FieldTypes(AttributeTemplate):
    key = TupleReference

    def generic_resolve(self, reference: TupleReference, field_name: str) -> Any:
        fields = reference.tuple_type.fields
        if field_name not in fields:
            return None
        return reference.tuple_type.types[fields.index(field_name)]


@lower_getattr_generic(TupleReference)
def _load_field(
    context: Any, builder: Any, reference: TupleReference, pointer: Any, field_name: str
) -> Any:
    index = reference.tuple_type.fields.index(field_name)
    field = builder.load(cgutils.gep_inbounds(builder, pointer, 0, index))
    return impl_ret_borrowed(context, builder, reference.tuple_type.types[index], field)


@unbox(TupleReference)
def _store_in_frame(reference: TupleReference, instance: Any, context: Any) -> NativeValue:
    native = context.unbox(reference.tuple_type, instance)
    pointer = cgutils.alloca_once_value(context.builder, native.value)
    return NativeValue(pointer, is_error=native.is_error, cleanup=native.cleanup)
