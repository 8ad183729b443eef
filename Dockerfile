# docker build -t factorgraph-adj .
# docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" factorgraph-adj adjust site
FROM python:3.12-slim AS wheel
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir build && python -m build --wheel --outdir /wheel

FROM python:3.12-slim
COPY --from=wheel /wheel /wheel
RUN wheel=$(echo /wheel/*.whl) \
    && pip install --no-cache-dir "${wheel}[cli,plot,crs,report,xlsx,serve,instruments,postgresql]" \
    && rm -r /wheel \
    && useradd --create-home surveyor
USER surveyor
WORKDIR /data
ENTRYPOINT ["factorgraph-adj"]
CMD ["--help"]
