"""Steps of training as CUDA graphs: what the device does in a step is recorded once, and then replayed."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


class StepGraph:
    """A function of tensors, recorded at its fourth call and replayed from then on.

    The function has to keep its shapes, and must not wait for the host. `key` says what it belongs to. Results are
    overwritten by the next call.
    """

    def __init__(self, function: Callable[..., tuple[Tensor, ...]], key: object) -> None:
        self._function, self.key = function, key
        self._stream = torch.cuda.Stream()
        self._calls = 0
        self._graph: torch.cuda.CUDAGraph | None = None
        self._inputs: tuple[Tensor, ...] = ()
        self._results: tuple[Tensor, ...] = ()

    def __call__(self, *inputs: Tensor, device: torch.device) -> tuple[Tensor, ...]:
        """The function's results for tensors on any device."""
        on_device = tuple(tensor.to(device, non_blocking=True) for tensor in inputs)
        self._calls += 1
        # three steps are done one by one first, in which libraries and the optimiser prepare themselves
        if self._calls <= 3:
            self._stream.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(self._stream):
                results = self._function(*on_device)
            torch.cuda.current_stream().wait_stream(self._stream)
            return results
        if self._graph is None:
            self._inputs, self._graph = on_device, torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph):
                self._results = self._function(*self._inputs)
        for stored, given in zip(self._inputs, on_device, strict=True):
            stored.copy_(given)
        self._graph.replay()
        return self._results
