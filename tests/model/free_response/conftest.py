"""Small randomly drawn checkpoints of both Chronos families, saved as a user's directory would be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="session")
def bolt_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Chronos-Bolt checkpoint that forecasts 16 steps, with random weights."""
    import torch
    from chronos.chronos_bolt import ChronosBoltModelForForecasting
    from transformers import T5Config

    config = T5Config(
        d_model=16,
        d_kv=8,
        d_ff=32,
        num_layers=1,
        num_decoder_layers=1,
        num_heads=2,
        initializer_factor=0.2,
        feed_forward_proj="relu",
        vocab_size=2,
        pad_token_id=0,
        decoder_start_token_id=0,
        chronos_pipeline_class="ChronosBoltPipeline",
        chronos_config={
            "context_length": 128,
            "prediction_length": 16,
            "input_patch_size": 16,
            "input_patch_stride": 16,
            "quantiles": (np.arange(1, 10) / 10).tolist(),
            "use_reg_token": True,
        },
    )
    config.reg_token_id = 1
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("bolt")
    ChronosBoltModelForForecasting(config).save_pretrained(folder)
    return folder


@pytest.fixture(scope="session")
def chronos2_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Chronos-2 checkpoint with random weights."""
    import torch
    from chronos.chronos2 import Chronos2Model
    from chronos.chronos2.config import Chronos2CoreConfig

    config = Chronos2CoreConfig(
        d_model=16,
        d_kv=8,
        d_ff=32,
        num_layers=1,
        num_heads=2,
        initializer_factor=0.5,
        reg_token_id=1,
        chronos_pipeline_class="Chronos2Pipeline",
        chronos_config={
            "context_length": 256,
            "output_patch_size": 16,
            "input_patch_size": 16,
            "input_patch_stride": 16,
            "quantiles": [0.01, 0.05, *(np.arange(1, 10) / 10).tolist(), 0.95, 0.99],
            "use_reg_token": True,
            "use_arcsinh": True,
            "max_output_patches": 4,
        },
        architectures=["Chronos2Model"],
    )
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("chronos2")
    Chronos2Model(config).save_pretrained(folder)
    return folder
