/* A policy for peg-insertion in C, on the frames of docs/policy-protocol.md: pushes the peg back against the mean drift
   of the markers, rounded so that the order of the sum does not matter. */

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static void read_all(int channel, void *data, size_t bytes) {
    for (char *place = data; bytes > 0;) {
        ssize_t got = read(channel, place, bytes);
        if (got <= 0) exit(0); /* the evaluator has gone */
        place += got, bytes -= (size_t)got;
    }
}

static void write_all(int channel, const void *data, size_t bytes) {
    for (const char *place = data; bytes > 0;) {
        ssize_t put = write(channel, place, bytes);
        if (put <= 0) exit(0);
        place += put, bytes -= (size_t)put;
    }
}

/* Answer with a header and, where there is one, an action of three numbers. */
static void answer(int channel, long seq, const char *kind, const double *action) {
    const char *arrays = action ? "[{\"name\":\"action\",\"dtype\":\"f8\",\"shape\":[3]}]" : "[]";
    char header[256];
    uint32_t header_bytes =
        (uint32_t)snprintf(header, sizeof header, "{\"seq\":%ld,\"kind\":\"%s\",\"arrays\":%s}", seq, kind, arrays);
    uint64_t payload_bytes = action ? 3 * sizeof *action : 0;
    char prefix[16] = "VTC1";
    memcpy(prefix + 4, &header_bytes, 4);
    memcpy(prefix + 8, &payload_bytes, 8);
    write_all(channel, prefix, sizeof prefix);
    write_all(channel, header, header_bytes);
    if (action) write_all(channel, action, payload_bytes);
}

/* Markers are [gel][reference, current][marker][u, v]; submission.yaml asks for nothing else. */
static double mean_drift(const float *flow, size_t numbers) {
    size_t markers = numbers / 8;
    double sum = 0;
    for (size_t gel = 0; gel < 2; gel++)
        for (size_t marker = 0; marker < markers; marker++) {
            const float *reference = flow + (gel * 2 * markers + marker) * 2;
            sum += (double)reference[2 * markers + 1] - (double)reference[1];
        }
    return sum / (2.0 * (double)markers);
}

int main(void) {
    int channel = atoi(getenv("VITAC_CHANNEL"));
    for (;;) {
        char prefix[16], header[32769] = "";
        uint32_t header_bytes;
        uint64_t payload_bytes;
        read_all(channel, prefix, sizeof prefix);
        memcpy(&header_bytes, prefix + 4, 4);
        memcpy(&payload_bytes, prefix + 8, 8);
        read_all(channel, header, header_bytes);
        float *payload = malloc(payload_bytes + 1);
        read_all(channel, payload, payload_bytes);

        long seq = strtol(strstr(header, "\"seq\":") + 6, NULL, 10);
        if (strstr(header, "\"kind\":\"load\"")) {
            answer(channel, seq, "loaded", NULL);
        } else if (strstr(header, "\"kind\":\"reset\"")) {
            answer(channel, seq, "ready", NULL);
        } else if (strstr(header, "\"kind\":\"believe\"")) {
            answer(channel, seq, "belief", NULL); /* it has none */
        } else {
            double drift = mean_drift(payload, payload_bytes / sizeof *payload);
            double push = round(fmin(1, fmax(-1, -drift)) * 1000) / 1000;
            answer(channel, seq, "action", (double[]){0, push, 0});
        }
        free(payload);
    }
}
