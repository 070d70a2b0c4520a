"""Foundation models with random weights, built by their own packages: the real operations, without the real weights.

`tiny` ones are for tests. Others have the published sizes where a package or a checkpoint's card holds them (Chronos,
TimesFM, FlowState), else sizes that give about the published number of parameters. What depends on operations (scaling,
gaps, horizons, time, memory) is theirs; what depends on training is not.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

LEVELS = [level / 10 for level in range(1, 10)]


def save_tirex2(folder: Path, tiny: bool) -> None:
    """TiRex-2; its checkpoints hold a tensor of several names once."""
    from safetensors.torch import save_file
    from tirex2 import TiRex2

    width, heads, blocks, patch = (32, 4, 2, 16) if tiny else (512, 4, 12, 32)

    def block(kind: str) -> dict[str, Any]:
        size = {"embedding_dim": width, "num_heads": heads}
        time_mixer = {"model_type": kind, "num_slstm_heads": heads, **size}
        return {"time_mixer": time_mixer, "variate_mixer": size, "dropout": 0.0, "eps": 1e-6}

    config = {
        "stack_config": {
            "templates": {"m": block("bi-mlstm"), "s": block("bi-slstm")},
            "recipe": ["s" if i % 4 == 1 else "m" for i in range(blocks)],
        },
        "tokenizer_cfg": {"input_patch_size": patch, "output_patch_size": patch, "input_patch_stride": patch},
        "scaler_cfg": {},
        "quantiles": LEVELS,
        "act_func": "SiLU",
        **{"dropout": 0.0, "h_expand": 2.0, "num_blocks": blocks, "embedding_dim": width, "input_ff_dim": width},
        **{"input_patch_size": patch, "output_patch_size": patch},
        **({"context_len": 256, "future_len": 64} if tiny else {"context_len": 2048, "future_len": 320}),
    }
    state = TiRex2(**config, device="cpu").state_dict()
    once = {value.data_ptr(): name for name, value in state.items()}
    save_file({name: state[name].contiguous() for name in once.values()}, folder / "model.safetensors")
    (folder / "config.json").write_text(json.dumps(config))


def save_timesfm(folder: Path, tiny: bool) -> None:
    """TimesFM 2.5, whose sizes stand in its class: a tiny one is loaded where they are those of `tiny_timesfm`."""
    from safetensors.torch import save_file
    from timesfm.timesfm_2p5 import timesfm_2p5_torch as by_torch

    module = by_torch.TimesFM_2p5_200M_torch_module
    full = module.config
    try:
        module.config = tiny_timesfm() if tiny else full
        save_file(module().state_dict(), folder / "model.safetensors")
    finally:
        module.config = full


def tiny_timesfm() -> Any:
    """A small definition of TimesFM 2.5."""
    from timesfm.timesfm_2p5 import timesfm_2p5_base as base

    full = base.TimesFM_2p5_200M_Definition()
    small = {"input_dims": 32, "hidden_dims": 32}
    transformer = replace(full.stacked_transformers.transformer, model_dims=32, hidden_dims=32, num_heads=2)
    return replace(
        full,
        tokenizer=replace(full.tokenizer, hidden_dims=32, output_dims=32),
        stacked_transformers=replace(full.stacked_transformers, num_layers=2, transformer=transformer),
        output_projection_point=replace(full.output_projection_point, **small),
        output_projection_quantiles=replace(full.output_projection_quantiles, **small),
    )


def save_timesfm3(folder: Path, tiny: bool) -> None:
    """TimesFM 3."""
    from timesfm3 import ResidualBlockConfig, StackedTransformersConfig, TimesFM3Torch, TransformerConfig

    width, heads, layers = (32, 2, 2) if tiny else (1280, 16, 20)
    transformer = TransformerConfig(
        **{"model_dims": width, "hidden_dims": width, "num_heads": heads, "use_bias": False, "ff_activation": "relu"},
        **{"attention_norm": "rms", "feedforward_norm": "rms", "qk_norm": "rms"},
        **{"use_rope_seq": True, "use_rope_var": tiny, "deterministic": True},
    )
    model = TimesFM3Torch(
        input_patch_len=32,
        output_patch_len=64,
        quantiles=LEVELS,
        residual_block_config=ResidualBlockConfig(width, width, use_bias=False, activation="relu"),
        transformer_config=StackedTransformersConfig(num_layers=layers, transformer=transformer),
    )
    model.pre_transformer_resblock.set_input_dims(2 * (32 + 64))
    model.save_pretrained(folder)


def save_toto2(folder: Path, tiny: bool) -> None:
    """Toto 2."""
    from safetensors.torch import save_file
    from toto2 import Toto2Model, Toto2ModelConfig

    patch, width, heads, layers = (16, 32, 2, 2) if tiny else (32, 384, 6, 12)
    config = Toto2ModelConfig(
        **{"patch_size": patch, "d_model": width, "num_heads": heads, "num_layers": layers},
        **{"layer_group_size": 2 if tiny else 12, "num_variate_layers_per_group": 1},
        **{"variate_layer_first": False, "residual_attn_ratio": 2.0},
    )
    save_file(Toto2Model(config).state_dict(), folder / "model.safetensors")
    (folder / "config.json").write_text(json.dumps(asdict(config)))


def save_ttm(folder: Path, tiny: bool) -> None:
    """A Tiny Time Mixer that forecasts quantiles."""
    from tsfm_public.models.tinytimemixer import TinyTimeMixerConfig, TinyTimeMixerForPrediction

    tiny_sizes = {"context_length": 128, "patch_length": 16, "patch_stride": 16, "d_model": 16, "num_layers": 1}
    sizes = {"context_length": 512, "patch_length": 32, "patch_stride": 32, "d_model": 192, "num_layers": 3}
    decoder = {"decoder_num_layers": 1} if tiny else {"decoder_num_layers": 2, "decoder_d_model": 128}
    config = TinyTimeMixerConfig(
        **(tiny_sizes if tiny else sizes), **decoder, prediction_length=30, multi_quantile_head=True
    )
    TinyTimeMixerForPrediction(config).save_pretrained(folder)


def save_flowstate(folder: Path, tiny: bool) -> None:
    """FlowState."""
    from tsfm_public.models.flowstate import FlowStateConfig, FlowStateForPrediction

    sizes = {"embedding_feature_dim": 16, "encoder_num_layers": 1, "encoder_state_dim": 16, "decoder_dim": 8}
    config = FlowStateConfig(context_length=256, encoder_num_hippo_blocks=2, **sizes) if tiny else FlowStateConfig()
    FlowStateForPrediction(config).save_pretrained(folder)


def save_bolt(folder: Path, tiny: bool) -> None:
    """Chronos-Bolt of the size 'small'."""
    from chronos.chronos_bolt import ChronosBoltModelForForecasting
    from transformers import T5Config

    width, inner, layers, heads, each = (16, 32, 1, 2, 8) if tiny else (512, 2048, 6, 8, 64)
    config = T5Config(
        **{"d_model": width, "d_kv": each, "d_ff": inner, "num_layers": layers, "num_decoder_layers": layers},
        **{"num_heads": heads, "initializer_factor": 0.2 if tiny else 0.05, "feed_forward_proj": "relu"},
        **{"vocab_size": 2, "pad_token_id": 0, "decoder_start_token_id": 0},
        chronos_pipeline_class="ChronosBoltPipeline",
        chronos_config={
            **{"context_length": 128 if tiny else 2048, "prediction_length": 16 if tiny else 64},
            **{"input_patch_size": 16, "input_patch_stride": 16, "quantiles": LEVELS, "use_reg_token": True},
        },
    )
    config.reg_token_id = 1
    ChronosBoltModelForForecasting(config).save_pretrained(folder)


def save_chronos2(folder: Path, tiny: bool) -> None:
    """Chronos-2."""
    from chronos.chronos2 import Chronos2Model
    from chronos.chronos2.config import Chronos2CoreConfig

    width, inner, layers, heads, each = (16, 32, 1, 2, 8) if tiny else (768, 3072, 12, 12, 64)
    config = Chronos2CoreConfig(
        **{"d_model": width, "d_kv": each, "d_ff": inner, "num_layers": layers, "num_heads": heads},
        **{"initializer_factor": 0.5 if tiny else 0.05, "reg_token_id": 1},
        chronos_pipeline_class="Chronos2Pipeline",
        chronos_config={
            **{"context_length": 256 if tiny else 8192, "max_output_patches": 4 if tiny else 64},
            **{"output_patch_size": 16, "input_patch_size": 16, "input_patch_stride": 16},
            **{"quantiles": [0.01, 0.05, *LEVELS, 0.95, 0.99], "use_reg_token": True, "use_arcsinh": True},
        },
        architectures=["Chronos2Model"],
    )
    Chronos2Model(config).save_pretrained(folder)


MAKERS: dict[str, Callable[[Path, bool], None]] = {
    "chronos-bolt-small": save_bolt,
    "chronos-2": save_chronos2,
    "tirex-2": save_tirex2,
    "timesfm": save_timesfm,
    "timesfm-3": save_timesfm3,
    "toto-2": save_toto2,
    "ttm": save_ttm,
    "flowstate": save_flowstate,
}
