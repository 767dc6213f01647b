# `docker build -t ggvs-eval . && docker run -v "$PWD/out:/ggvs-eval/out" ggvs-eval` evaluates the demo; the page lies in out/demo/report.
# torch's default build for Linux carries CUDA: pass --build-arg PIP_EXTRA_INDEX_URL=<index of torch's CPU builds> for a small image.
FROM python:3.11-slim
ARG PIP_EXTRA_INDEX_URL
RUN apt-get update && apt-get install -y --no-install-recommends make g++ libusb-1.0-0 libgl1 libx11-6 libudev1 libgomp1 \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /ggvs-eval
COPY . .
RUN make .venv/.ready
VOLUME /ggvs-eval/out
ENTRYPOINT ["make"]
CMD ["reports"]
