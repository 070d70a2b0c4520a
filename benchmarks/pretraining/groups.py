"""Attention of Chronos-2 within groups of one size, which costs a batch of n groups an n-th of the library's masks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from torch import Tensor


@contextmanager
def attend_within_groups(model: Any, rows: int) -> Iterator[None]:
    """Within the block, `model` (a `Chronos2Model`) attends within groups of `rows` consecutive rows of the batch."""
    layers = [block.layer[1] for block in model.encoder.block]
    for layer in layers:
        layer.forward = partial(_within_groups, layer, rows)
    try:
        yield
    finally:
        for layer in layers:
            del layer.forward


def _within_groups(
    layer: Any, rows: int, hidden_states: Tensor, attention_mask: Tensor, output_attentions: bool = False
) -> Any:
    """`GroupSelfAttention.forward` (`hidden_states` (B, T, d), `attention_mask` (T, 1, B, B)) for groups of `rows`."""
    from chronos.chronos2.layers import AttentionOutput

    batch, time, width = hidden_states.shape
    n = batch // rows
    grouped = hidden_states.view(n, rows, time, width).transpose(1, 2).reshape(n * time, rows, width)
    blocks = attention_mask.view(time, n, rows, n, rows).diagonal(dim1=1, dim2=3)  # (T, rows, rows, n)
    mask = blocks.permute(3, 0, 1, 2).reshape(n * time, 1, rows, rows)
    mixed = grouped + layer.dropout(layer.self_attention(layer.layer_norm(grouped), mask=mask)[0])
    back = mixed.view(n, time, rows, width).transpose(1, 2).reshape(batch, time, width)
    return AttentionOutput(hidden_states=back, attn_weights=None)
