# An image with cosim installed, for any user: docker run --user $(id -u) -v $PWD:/work ...
# Its build runs the reference scenario, which compiles the kernels once; whoever runs it reads them.
FROM python:3.13-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends make \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /cosim
COPY . .
RUN make demo && rm -rf runs && mkdir --mode=1777 /work
ENV PATH="/cosim/.venv/bin:${PATH}"
WORKDIR /work
