"""Iterations that a traced graph holds once, as a loop, instead of once for each time."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

Carry = tuple[Tensor, ...]


def repeat(
    step: Callable[[Carry, float | Tensor], Carry], start: Carry, values: Sequence[float]
) -> Carry:
    """Apply a step to what the step before gave, once for each value.

    Solvers of many small operators would otherwise fill a graph with copies of themselves, and a
    runtime spends longer on loading such a graph than on running it.

    Args:
        step: gives tensors of the same shapes as it gets; it may read tensors from outside.
        start: what the first step gets.
        values: one number for each step.
    """
    if not torch.compiler.is_exporting():
        for value in values:
            start = step(start, value)
        return start
    from torch._higher_order_ops.scan import scan  # torch has no public name for it yet

    def body(carry: Carry, value: Tensor) -> tuple[Carry, Tensor]:
        # The loop may not give back what it got: copies are free in the graph.
        return tuple(t.clone() for t in step(carry, value)), value.clone()

    return scan(body, tuple(t.clone() for t in start), torch.tensor(values))[0]
