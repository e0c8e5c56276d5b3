#!/bin/sh
# Makes src/bindings.rs anew: needs bindgen (cargo install bindgen-cli) and libclang. Run here, with the headers of linux-libc-dev 6.1 or
# later. Not part of any build.
set -eu
cd "$(dirname "$0")"
bindgen wrapper.h --output src/bindings.rs --rust-edition 2021 --rust-target 1.85 --no-doc-comments \
    --allowlist-type 'v4l2_(capability|fmtdesc|frmsizeenum|frmsizetypes|frmivalenum|frmivaltypes|format|pix_format|fract|streamparm|captureparm|outputparm)' \
    --allowlist-type 'v4l2_(buf_type|memory|field|ctrl_type|queryctrl|querymenu|query_ext_ctrl|control|ext_control|ext_controls|requestbuffers|buffer|exportbuffer)' \
    --allowlist-type 'v4l2_(framebuffer|std_id|standard|input|output|tuner|modulator|frequency|audio|audioout|edid|cropcap|crop|jpegcompression)' \
    --allowlist-type 'v4l2_(sliced_vbi_cap|enc_idx|encoder_cmd)' \
    --allowlist-type 'timeval|time_t' \
    --allowlist-var 'V4L2_(CAP|BUF_FLAG|CTRL_FLAG)_[A-Z0-9_]+|V4L2_PIX_FMT_PRIV_MAGIC' \
    -- ${BINDGEN_CLANG_ARGS:-}
