# `tf-mpc` in an image:
#   docker build -t tf-mpc .
#   docker run --rm -v "$PWD:/home/runner/work" -w /home/runner/work tf-mpc run --testcase bestest_hydronic_heat_pump
# A real building, from the files of `tf-mpc init --for` (secrets: --env-file, mode 600):
#   docker run -d --restart unless-stopped --init --stop-timeout 90 --env-file secrets -v "$PWD:/home/runner/work" \
#     -w /home/runner/work tf-mpc control --model my_house --map map.yaml --connection connection.yaml
# Its page: -p 8010:8010, --page 0.0.0.0:8010, and TF_MPC_PAGE_TOKEN among the secrets. Home Assistant: tools/addon.py.
FROM python:3.12-slim
COPY . /src
# The files whose hashes requirements.txt has. torch is the CPU build, 200 MB instead of several GB, of an index of its own.
ENV PIP_NO_CACHE_DIR=1 PIP_CONSTRAINT=/src/constraints.txt
RUN pip install --no-deps --require-hashes -r /src/requirements.txt \
    && pip install --no-deps --index-url https://download.pytorch.org/whl/cpu torch \
    && pip install --no-deps /src \
    && pip check \
    && rm -r /src \
    && useradd --create-home runner
USER runner
# Of a real building's control: each step, of an hour at most, writes its log.
HEALTHCHECK --interval=10m --timeout=10s CMD ["sh", "-c", "test ! -e control/log.jsonl || test -n \"$(find control/log.jsonl -mmin -130)\""]
WORKDIR /home/runner
ENTRYPOINT ["tf-mpc"]
CMD ["--help"]
