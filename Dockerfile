# embodichain on slim Debian, without a GPU: pictures are drawn by Mesa's software OpenGL.
#
#   docker build -t embodichain .
#   docker run --rm -v "$PWD/outputs:/data/outputs" embodichain run task=reach num_envs=4
#
# TORCH_INDEX is PyTorch's index of CPU builds; without it pip takes the CUDA build, some GB larger.
# `scripts/dockerfile_steps.py` runs these steps without Docker; it knows the instructions used here.

FROM debian:12-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv
WORKDIR /source
COPY constraints.txt /pins/constraints.txt
RUN python3 -m venv /build && /build/bin/pip install --no-cache-dir -c /pins/constraints.txt build setuptools
COPY . /source
RUN /build/bin/python -m build --no-isolation --wheel --outdir /dist

FROM debian:12-slim
ARG TORCH_INDEX=
ARG EXTRAS=robots,video
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv libegl1 libgl1-mesa-dri libopengl0 && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /opt/embodichain && useradd --create-home --uid 1000 embodichain && install -d -o embodichain /data
COPY constraints.txt /pins/constraints.txt
RUN /opt/embodichain/bin/pip install --no-cache-dir -c /pins/constraints.txt ${TORCH_INDEX:+--index-url "$TORCH_INDEX"} torch
COPY --from=build /dist /dist
RUN /opt/embodichain/bin/pip install --no-cache-dir -c /pins/constraints.txt "$(echo /dist/*.whl)[$EXTRAS]"
ENV PATH=/opt/embodichain/bin:/usr/local/bin:/usr/bin:/bin
USER embodichain
WORKDIR /data
ENTRYPOINT ["embodichain"]
CMD ["--help"]
