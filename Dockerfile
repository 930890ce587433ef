# An image with cosim installed. Its build runs the reference scenario, which compiles the kernels once.
FROM python:3.13-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends make \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /cosim
COPY . .
RUN make demo
ENV PATH="/cosim/.venv/bin:${PATH}"
