# An image with the command line. `tests/package.sh` runs the RUN lines in a fresh environment; no image is built there.
FROM python:3.11-slim
COPY . /src
RUN pip install --no-cache-dir /src
WORKDIR /work
CMD ["jrdb-avr", "--help"]
