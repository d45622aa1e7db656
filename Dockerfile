# docker build -t pcretrieve . && docker run --rm -v "$PWD:/data" pcretrieve ingest scans -c bodies.sqlite
# docker run --rm -it -v "$PWD:/data" --network host pcretrieve serve -c bodies.sqlite
FROM python:3.11-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends \
    libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1 && rm -rf /var/lib/apt/lists/*
COPY pyproject.toml setup.py README.md LICENSE /source/
COPY pcretrieve /source/pcretrieve
RUN pip install --no-cache-dir /source && rm -r /source
WORKDIR /data
ENTRYPOINT ["pcretrieve"]
