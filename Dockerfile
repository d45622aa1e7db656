# docker build -t pcretrieve .
# docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" pcretrieve ingest scans -c bodies.sqlite
# docker run --rm -it --user "$(id -u):$(id -g)" -v "$PWD:/data" --network host pcretrieve serve -c bodies.sqlite
FROM python:3.11-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends \
    libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1 && rm -rf /var/lib/apt/lists/*
# What was tested, by its hashes: with all extras, 2 GB.
COPY requirements.lock pyproject.toml setup.py README.md LICENSE /source/
RUN pip install --no-cache-dir --require-hashes -r /source/requirements.lock
COPY pcretrieve /source/pcretrieve
# Built by what the lock has, not by what an index has today.
RUN pip install --no-cache-dir --no-deps --no-build-isolation /source && rm -r /source
# --user gives the rights of who starts it, by which it can write the files in /data.
RUN useradd --create-home pcretrieve && mkdir /data && chown pcretrieve /data
USER pcretrieve
WORKDIR /data
ENTRYPOINT ["pcretrieve"]
