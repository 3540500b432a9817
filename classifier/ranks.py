"""The processes that train one network together, as ``torchrun`` starts them; or just one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import nn

_LONGEST_WAIT = timedelta(hours=12)
"""For the slowest process, which may still be preparing clips; one that died ends the others at once."""


@dataclass(frozen=True)
class Ranks:
    """One process among those that train together.

    Attributes:
        rank: its number; 0 is the one that writes.
        count: how many there are.
        device: what it computes on.
    """

    rank: int
    count: int
    device: torch.device

    @property
    def is_first(self) -> bool:
        """Whether it is the one that writes."""
        return self.rank == 0

    def wait(self) -> None:
        """Until all have come here."""
        if self.count > 1:
            dist.barrier()

    def gathered(self, value: Any) -> list[Any]:
        """Everybody's value, by rank."""
        if self.count == 1:
            return [value]
        found: list[Any] = [None] * self.count
        dist.all_gather_object(found, value)
        return found

    def share_buffers(self, module: nn.Module) -> None:
        """Gives everybody the first one's running means, which are each one's own otherwise."""
        if self.count > 1:
            for buffer in module.buffers():
                dist.broadcast(buffer, 0)


@contextmanager
def joined() -> Iterator[Ranks]:
    """Joins the processes that ``torchrun`` has started, through NCCL on GPUs and Gloo on processors."""
    count, on_gpu = int(os.environ.get("WORLD_SIZE", "1")), torch.cuda.is_available()
    if on_gpu:
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    device = torch.device("cuda", torch.cuda.current_device()) if on_gpu else torch.device("cpu")
    if count == 1:
        yield Ranks(0, 1, device)
        return
    dist.init_process_group("nccl" if on_gpu else "gloo", timeout=_LONGEST_WAIT)
    try:
        yield Ranks(dist.get_rank(), count, device)
    finally:
        dist.destroy_process_group()
