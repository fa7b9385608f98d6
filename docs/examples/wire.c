/* One joint held at an angle over UDP: cc -std=c99 -o wire wire.c && ./wire 127.0.0.1 7070 200 0.5
 *
 * The other end of `flexarm serve`, without a key: HELLO, CHALLENGE, HELLO with the challenge's cookie, WELCOME, then a
 * COMMAND a period and a READING back. For a little-endian machine with POSIX sockets. Control is PD here: 8 N m/rad, 1.5 N m s/rad.
 */
#define _POSIX_C_SOURCE 200112L
#include <arpa/inet.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>

enum { HELLO = 1, WELCOME, COMMAND, READING, BYE, CHALLENGE, ARM = 1, RESET = 4, VERSION = 2, HEAD = 32, MOST = 138 };

typedef struct {           /* offsets 0, 4, 6, 7, 8, 16, 20, 24: no gaps between them */
    char magic[4];
    uint16_t version;
    uint8_t kind, flags;
    uint64_t connection;
    uint32_t sequence, count;
    double time, numbers[MOST];
} packet;

static int put(int wire, packet *p, int kind, int flags, uint32_t count)
{
    memcpy(p->magic, "FXRM", 4);
    p->version = VERSION;
    p->kind = (uint8_t)kind;
    p->flags = (uint8_t)flags;
    p->sequence += kind != HELLO;
    p->count = count;
    return send(wire, p, HEAD + 8 * count, 0) < 0;
}

/* The newest packet of a kind; 0 where none comes within the socket's time. Older ones that wait are left behind: a peer
 * that was late would act on what is past. */
static int take(int wire, packet *p, int kind)
{
    struct pollfd more = {.fd = wire, .events = POLLIN};
    packet next;
    int found = 0;
    for (int tries = 0; tries < (found ? 1000 : 8) && (!found || poll(&more, 1, 0) > 0); tries++) {
        ssize_t size = recv(wire, &next, sizeof next, 0);
        if (size < 0) break;
        if (size >= HEAD && !memcmp(next.magic, "FXRM", 4) && next.version == VERSION && next.kind == kind &&
            next.count <= MOST && size == (ssize_t)(HEAD + 8 * next.count))
            *p = next, found = 1;
    }
    return found;
}

int main(int words, char **word)
{
    if (words != 5) return fprintf(stderr, "%s ADDRESS PORT PERIODS ANGLE\n", word[0]), 2;
    struct sockaddr_in arm = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(word[2]))};
    struct timeval patience = {.tv_sec = 2};
    int wire = socket(AF_INET, SOCK_DGRAM, 0);
    inet_pton(AF_INET, word[1], &arm.sin_addr);
    setsockopt(wire, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    if (connect(wire, (struct sockaddr *)&arm, sizeof arm)) return perror("connect"), 1;

    packet mine = {.connection = 4711}, theirs;
    if (put(wire, &mine, HELLO, 0, 2) || !take(wire, &theirs, CHALLENGE)) return fputs("no answer\n", stderr), 1;
    memcpy(mine.numbers, theirs.numbers, 2 * sizeof(double)); /* the cookie */
    if (put(wire, &mine, HELLO, 0, 2) || !take(wire, &theirs, WELCOME)) return fputs("no welcome\n", stderr), 1;
    mine.connection = theirs.connection;
    const double limit = theirs.numbers[4], goal = atof(word[4]);
    const int joints = (int)theirs.numbers[1];
    if (joints != 1) return fprintf(stderr, "%d joints: this is for one\n", joints), 1;

    mine.numbers[0] = 0.0;
    for (int k = 0; k < atoi(word[3]); k++) {
        if (put(wire, &mine, COMMAND, k == 0 ? ARM | RESET : 0, 1) || !take(wire, &theirs, READING))
            return fputs("no reading\n", stderr), 1;
        /* numbers: last command, status, angle, rate, torque applied, then what the sensors read */
        double torque = 8.0 * (goal - theirs.numbers[2]) - 1.5 * theirs.numbers[3];
        mine.numbers[0] = torque > limit ? limit : torque < -limit ? -limit : torque;
    }
    printf("%.6f\n", theirs.numbers[2]);
    return put(wire, &mine, BYE, 0, 0);
}
