"""Architectures of the shipped forecasters, built from the classes of chronos-forecasting."""

from __future__ import annotations

from typing import Any

CONTEXT = 512
HORIZON = 64
PATCH = 16
QUANTILES = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]


def build_weather_model(d_model: int = 96, d_ff: int = 256, layers: int = 4) -> Any:
    """A randomly initialised `Chronos2Model` (from torch's global seed), of what a linear weather model leaves over."""
    from chronos.chronos2.config import Chronos2CoreConfig
    from chronos.chronos2.model import Chronos2Model

    config = Chronos2CoreConfig(
        d_model=d_model,
        d_kv=d_model // 4,
        d_ff=d_ff,
        num_layers=layers,
        num_heads=4,
        dropout_rate=0.0,
        initializer_factor=0.2,
        feed_forward_proj="relu",
    )
    config.architectures = ["Chronos2Model"]
    config.after_linear_weather = True
    config.chronos_pipeline_class = "Chronos2Pipeline"
    config.chronos_config = {
        "context_length": CONTEXT,
        "output_patch_size": PATCH,
        "input_patch_size": PATCH,
        "input_patch_stride": PATCH,
        "quantiles": QUANTILES,
        "use_reg_token": True,
        "use_arcsinh": True,
        "max_output_patches": HORIZON // PATCH,
        "time_encoding_scale": CONTEXT,
    }
    return Chronos2Model(config)


def build_model(d_model: int = 64, d_ff: int = 256, encoder_layers: int = 2, decoder_layers: int = 1) -> Any:
    """A randomly initialised `ChronosBoltModelForForecasting` (from the global seed of torch)."""
    from chronos.chronos_bolt import ChronosBoltModelForForecasting
    from transformers import T5Config

    config = T5Config(
        d_model=d_model,
        d_ff=d_ff,
        d_kv=d_model // 4,
        num_heads=4,
        num_layers=encoder_layers,
        num_decoder_layers=decoder_layers,
        # In this architecture training diverges with 1.0 and starts slowly with 0.05.
        initializer_factor=0.2,
        dropout_rate=0.0,
        feed_forward_proj="relu",
        is_gated_act=False,
        dense_act_fn="relu",
        vocab_size=2,
        pad_token_id=0,
        eos_token_id=1,
        decoder_start_token_id=0,
        tie_word_embeddings=False,
    )
    config.architectures = ["ChronosBoltModelForForecasting"]
    config.chronos_pipeline_class = "ChronosBoltPipeline"
    config.chronos_config = {
        "context_length": CONTEXT,
        "prediction_length": HORIZON,
        "input_patch_size": PATCH,
        "input_patch_stride": PATCH,
        "quantiles": QUANTILES,
        "use_reg_token": True,
    }
    return ChronosBoltModelForForecasting(config)
