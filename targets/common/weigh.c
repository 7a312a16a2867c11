/* A plugin of QEMU: adds up weights of the instructions that are executed between the marks of mark.h.
 *
 *     -plugin libweigh.so,table=FILE
 *
 * FILE has one line per instruction: its address in hexadecimal, its length in bytes, COLUMNS weights, and
 * COLUMNS more that are added when the instruction is a branch that is taken. At each end mark the sums are
 * printed as "weighed <sum> ..". A program that executes an instruction between marks that FILE does not have,
 * or has with another length, is told so and ends. */
#include <inttypes.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- QEMU's interface for plugins, version 1: Debian does not ship its header ------------------------- */

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;

__attribute__((visibility("default"))) extern int qemu_plugin_version;
int qemu_plugin_version = 1;

enum { NO_REGISTERS = 0 }; /* the callback does not touch the guest's */

void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t id,
                                           void (*call)(qemu_plugin_id_t, struct qemu_plugin_tb *));
void qemu_plugin_register_vcpu_insn_exec_cb(struct qemu_plugin_insn *instruction,
                                            void (*call)(unsigned, void *), int flags, void *data);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *block);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *block, size_t index);
const void *qemu_plugin_insn_data(const struct qemu_plugin_insn *instruction);
uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *instruction);

/* ---- The table ---------------------------------------------------------------------------------------- */

#define COLUMNS 3

typedef struct weights {
	uint64_t address, size;
	uint64_t sum[COLUMNS], taken[COLUMNS];
} weights;

static weights *table;
static size_t count;

static int by_address(const void *a, const void *b) {
	const uint64_t x = ((const weights *)a)->address, y = ((const weights *)b)->address;
	return x < y ? -1 : x > y;
}

static int read_line(FILE *file, weights *w) {
	int read = fscanf(file, "%" SCNx64 " %" SCNu64, &w->address, &w->size);
	for (int i = 0; i < COLUMNS; i++) { read += fscanf(file, "%" SCNu64, &w->sum[i]); }
	for (int i = 0; i < COLUMNS; i++) { read += fscanf(file, "%" SCNu64, &w->taken[i]); }
	return read == 2 + 2 * COLUMNS;
}

static int read_table(const char *path) {
	FILE *file = fopen(path, "r");
	weights w;
	if (!file) { return 0; }
	while (read_line(file, &w)) {
		table = realloc(table, (count + 1) * sizeof *table);
		if (!table) { abort(); }
		table[count++] = w;
	}
	const int whole = feof(file);
	fclose(file);
	qsort(table, count, sizeof *table, by_address);
	return whole && count > 0;
}

/* Bytes of a Thumb instruction. QEMU's own figure is too large at the end of a page, where it looks ahead. */
static uint64_t length(const struct qemu_plugin_insn *instruction) {
	const uint8_t *byte = qemu_plugin_insn_data(instruction);
	return byte[1] >> 3 >= 0x1D ? 4 : 2;
}

static const weights *find(const struct qemu_plugin_insn *instruction) {
	const weights key = {.address = qemu_plugin_insn_vaddr(instruction)};
	const weights *w = bsearch(&key, table, count, sizeof *table, by_address);
	return w && w->size == length(instruction) ? w : NULL;
}

/* ---- Running ------------------------------------------------------------------------------------------ */

/* Instructions that are always executed together. */
typedef struct run {
	uint64_t begin, end; /* addresses */
	uint64_t unknown;    /* address of an instruction that is not in the table */
	uint64_t sum[COLUMNS];
	const weights *last;
} run;

static int weighing;
static uint64_t sums[COLUMNS];
static const run *before; /* the run executed last */

static void add(const uint64_t *weight) {
	for (int i = 0; i < COLUMNS; i++) { sums[i] += weight[i]; }
}

static void executed(unsigned cpu, void *data) {
	const run *now = data;
	(void)cpu;
	if (weighing) {
		if (now->unknown) {
			fprintf(stderr, "the instruction at 0x%" PRIx64 " has no weight\n", now->unknown);
			exit(1);
		}
		if (before->last && now->begin != before->end) { add(before->last->taken); }
		add(now->sum);
	}
	before = now;
}

static void begin_mark(unsigned cpu, void *data) {
	(void)cpu;
	before = data;
	memset(sums, 0, sizeof sums);
	weighing = 1;
}

static void end_mark(unsigned cpu, void *data) {
	executed(cpu, data);
	weighing = 0;
	fprintf(stderr, "weighed");
	for (int i = 0; i < COLUMNS; i++) { fprintf(stderr, " %" PRIu64, sums[i]); }
	fprintf(stderr, "\n");
}

static void (*const calls[])(unsigned, void *) = {executed, begin_mark, end_mark};

/* 1 or 2 for the marks, which are dbg #1 and dbg #2; 0 for others. */
static int mark(const struct qemu_plugin_insn *instruction) {
	const uint8_t *byte = qemu_plugin_insn_data(instruction);
	if (length(instruction) != 4 || byte[0] != 0xAF || byte[1] != 0xF3 || byte[3] != 0x80) {
		return 0;
	}
	return byte[2] == 0xF1 ? 1 : byte[2] == 0xF2 ? 2 : 0;
}

/* Empty, from an instruction on. */
static run *begin_run(const struct qemu_plugin_insn *instruction) {
	run *r = calloc(1, sizeof *r); /* for as long as QEMU runs, which may keep the callback */
	if (!r) { abort(); }
	r->begin = r->end = qemu_plugin_insn_vaddr(instruction);
	return r;
}

static void append(run *r, const struct qemu_plugin_insn *instruction) {
	r->last = find(instruction);
	r->end += length(instruction);
	if (!r->last) {
		r->unknown = qemu_plugin_insn_vaddr(instruction);
		return;
	}
	for (int i = 0; i < COLUMNS; i++) { r->sum[i] += r->last->sum[i]; }
}

/* A mark is a run of its own, without weight. */
static void translated(qemu_plugin_id_t id, struct qemu_plugin_tb *block) {
	run *r = NULL;
	(void)id;
	for (size_t i = 0; i < qemu_plugin_tb_n_insns(block); i++) {
		struct qemu_plugin_insn *instruction = qemu_plugin_tb_get_insn(block, i);
		const int kind = mark(instruction);
		if (kind || !r) {
			r = begin_run(instruction);
			qemu_plugin_register_vcpu_insn_exec_cb(instruction, calls[kind], NO_REGISTERS, r);
		}
		if (kind) {
			r->end += length(instruction);
			r = NULL;
		} else {
			append(r, instruction);
		}
	}
}

struct qemu_info; /* about the machine */

int qemu_plugin_install(qemu_plugin_id_t id, const struct qemu_info *info, int argc, char **argv);
__attribute__((visibility("default"))) int
qemu_plugin_install(qemu_plugin_id_t id, const struct qemu_info *info, int argc, char **argv) {
	static const run none;
	(void)info;
	if (argc != 1 || strncmp(argv[0], "table=", 6) != 0 || !read_table(argv[0] + 6)) {
		fprintf(stderr, "libweigh.so: no table of weights: -plugin libweigh.so,table=FILE\n");
		return 1;
	}
	before = &none;
	qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
	return 0;
}
