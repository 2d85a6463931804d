#!/bin/sh
# Measure the paper's networks on a GPU, within eight minutes: benchmarks/gpu.sh [OPTIONS of gpu.py]
# Takes .venv's Python where there is one, else python3, whose torch must know CUDA.
set -eu
cd "$(dirname "$0")/.."
python=python3
if [ -x .venv/bin/python ]; then python=.venv/bin/python; fi
"$python" -c 'import torch, sys; torch.cuda.is_available() or sys.exit("torch here sees no GPU; install one built for CUDA")'
if command -v nvidia-smi > /dev/null; then nvidia-smi --query-gpu=name,driver_version,power.limit --format=csv,noheader; fi
PYTHONPATH=".${PYTHONPATH:+:$PYTHONPATH}" OMP_NUM_THREADS=1 exec "$python" benchmarks/gpu.py "$@"
