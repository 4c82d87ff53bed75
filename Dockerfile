# embodichain on slim Debian, without a GPU: pictures are drawn by Mesa's software OpenGL.
#
#   docker build -t embodichain .
#   docker run --rm -v "$PWD/outputs:/data/outputs" embodichain run task=reach num_envs=4
#
# TORCH_INDEX is PyTorch's index of CPU builds; without it pip takes the CUDA build, some GB larger.
# Every package is compared with its hash in locked.txt; the project itself follows, from its source.
# `scripts/dockerfile_steps.py` runs these steps without Docker; it knows the instructions used here.
#
# The base is named by the digest of its index of all processors, as ten public Dockerfiles of October
# 2026 have it: no registry of images could be asked from where this was written. A newer one:
#   docker buildx imagetools inspect debian:12-slim

FROM debian:12-slim@sha256:7c7b2c966bc9ee8cedfeef67e0e279108992c77681fa595db4a9d65c06ccc587 AS build
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv
WORKDIR /source
COPY locked.txt /pins/locked.txt
COPY scripts/locked.py /pins/scripts/locked.py
RUN python3 -m venv /build && /build/bin/python /pins/scripts/locked.py install --only build,setuptools
COPY . /source
RUN /build/bin/python -m build --no-isolation --wheel --outdir /dist

FROM debian:12-slim@sha256:7c7b2c966bc9ee8cedfeef67e0e279108992c77681fa595db4a9d65c06ccc587
ARG TORCH_INDEX=
ARG EXTRAS=robots,video
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv libegl1 libgl1-mesa-dri libopengl0 && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /opt/embodichain && useradd --create-home --uid 1000 embodichain && install -d -o embodichain /data
COPY locked.txt /pins/locked.txt
COPY scripts/locked.py /pins/scripts/locked.py
RUN PIP_NO_CACHE_DIR=1 /opt/embodichain/bin/python /pins/scripts/locked.py install --extra "$EXTRAS" --torch-index "$TORCH_INDEX"
COPY --from=build /dist /dist
RUN /opt/embodichain/bin/pip install --no-cache-dir --no-deps /dist/*.whl && /opt/embodichain/bin/pip check
ENV PATH=/opt/embodichain/bin:/usr/local/bin:/usr/bin:/bin
USER embodichain
WORKDIR /data
ENTRYPOINT ["embodichain"]
CMD ["--help"]
