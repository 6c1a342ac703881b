// Samples as NDJSON over the serial line in, attitudes as NDJSON out: the lines of `stillpoint stream`.
// Beside this file: ekf.h and ekf.c of `stillpoint export-c -e ekf -o serial_ekf`.
// A line: {"t_ns":10000000,"gx":0.01,"gy":0,"gz":0,"ax":0,"ay":0,"az":9.81,"mx":18,"my":1,"mz":-42}
// in rad/s, m/s^2 and uT; without mx, my, mz where the magnetometer has no new sample. All lines with a broken or a
// missing number are left out: this sketch has no guard against clipped samples, which stream has.
#include "ekf.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

static ekf_filter filter;
static char line[256];
static unsigned length = 0;
static bool has_begun = false;
static uint64_t last_ns;

// The text after "name": in the line; NULL where there is none.
static const char *find_value(const char *name)
{
    const char *found = strstr(line, name);
    return found == NULL ? NULL : found + strlen(name);
}

static bool read_vector(const char *const names[3], sp_real values[3])
{
    for (int i = 0; i < 3; i++) {
        const char *text = find_value(names[i]);
        char *end;
        if (text == NULL) {
            return false;
        }
        values[i] = (sp_real)strtod(text, &end);
        if (end == text) { // null, or no number
            return false;
        }
    }
    return true;
}

static void take_line()
{
    static const char *const GYRO[3] = {"\"gx\":", "\"gy\":", "\"gz\":"};
    static const char *const ACCEL[3] = {"\"ax\":", "\"ay\":", "\"az\":"};
    static const char *const MAG[3] = {"\"mx\":", "\"my\":", "\"mz\":"};
    sp_real gyro[3], accel[3], mag[3], q_nb[4];
    const char *time = find_value("\"t_ns\":");
    uint64_t t_ns = 0;
    if (time == NULL || !read_vector(GYRO, gyro) || !read_vector(ACCEL, accel)) {
        return;
    }
    for (time += strspn(time, " "); *time >= '0' && *time <= '9'; time++) {
        t_ns = 10 * t_ns + (uint64_t)(*time - '0');
    }
    if (has_begun && t_ns <= last_ns) { // out of order
        return;
    }
    const sp_real dt_s = has_begun ? (sp_real)((double)(t_ns - last_ns) * 1e-9) : 0;
    has_begun = true;
    last_ns = t_ns;
    const bool ready = ekf_update(&filter, dt_s, gyro, accel, read_vector(MAG, mag) ? mag : NULL, q_nb, NULL, NULL);
    Serial.print("{\"estimator\":\"ekf\",\"q_nb\":[");
    for (int i = 0; i < 4; i++) {
        Serial.print(i == 0 ? "" : ",");
        Serial.print((double)q_nb[i], 9);
    }
    Serial.print(ready ? "],\"ready\":true}\n" : "],\"ready\":false}\n");
}

void setup()
{
    Serial.begin(115200);
    ekf_init(&filter);
}

void loop()
{
    while (Serial.available() > 0) {
        const char letter = (char)Serial.read();
        if (letter != '\n') {
            if (length < sizeof line) { // a longer line is left out
                line[length] = letter;
                length++;
            }
            continue;
        }
        if (length < sizeof line) {
            line[length] = 0;
            take_line();
        }
        length = 0;
    }
}
