# `tf-mpc` in an image:
#   docker build -t tf-mpc .
#   docker run --rm -v "$PWD:/home/runner/work" -w /home/runner/work tf-mpc run --testcase bestest_hydronic_heat_pump
FROM python:3.12-slim
COPY . /src
# The CPU build of torch: 200 MB instead of several GB.
RUN pip install --no-cache-dir --extra-index-url https://download.pytorch.org/whl/cpu '/src[serve,fmu]' \
    && rm -r /src \
    && useradd --create-home runner
USER runner
WORKDIR /home/runner
ENTRYPOINT ["tf-mpc"]
CMD ["--help"]
