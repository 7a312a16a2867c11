/* What regulators need that have memory, that adjust a step, or that reshape P. Other regulators do not link it.
 *
 * A refused sample leaves memory and P as they were, bit for bit. For that the storage ends with a copy of the
 * memory and, if P is reshaped, of the stored P, zeta, the gain and the numbers of P. */

#define EXTENSION_NUMBERS 4

/* The copies, behind the last vector. */
static COLD real *undo_of(const KOOP(rls) *rls) {
	return rls->error + rls->n_lifted_padded;
}

static COLD size_t extension_size(KOOP(rls) *rls, size_t covariance) {
	const KOOP(extension) *own = rls->config.regulator->extension;
	rls->n_undo = own->reshape ? covariance : 0;
	rls->n_memory = own->memory ? own->memory(rls) : 0;
	const size_t memory = KOOP_PAD(rls->n_memory), beside = 2 * rls->n_regressors_padded + EXTENSION_NUMBERS;
	const size_t copy_of_covariance = rls->n_undo > 0 ? rls->n_undo + beside : 0;
	rls->n_undo += memory;
	return 2 * memory + copy_of_covariance;
}

static COLD void extension_restart(KOOP(rls) *rls) {
	for (size_t i = 0; i < rls->n_memory; i++) { rls->memory[i] = 0; }
	if (rls->config.regulator->extension->reset) { rls->config.regulator->extension->reset(rls); }
}

static COLD void extension_keep(KOOP(rls) *rls) {
	real *numbers = undo_of(rls) + rls->n_undo + 2 * rls->n_regressors_padded;
	copy(undo_of(rls), rls->memory, rls->n_undo);
	if (!rls->config.regulator->extension->reshape) { return; }
	numbers[0] = rls->covariance_scale;
	numbers[1] = rls->covariance_bound;
	numbers[2] = (real)rls->positive_definite;
	numbers[3] = (real)rls->mirrored;
}

static COLD void extension_undo(KOOP(rls) *rls) {
	const real *numbers = undo_of(rls) + rls->n_undo + 2 * rls->n_regressors_padded;
	copy(rls->memory, undo_of(rls), rls->n_undo);
	if (!rls->config.regulator->extension->reshape) { return; }
	rls->covariance_scale = numbers[0];
	rls->covariance_bound = numbers[1];
	rls->positive_definite = numbers[2] > 0;
	rls->mirrored = (size_t)numbers[3];
}

static COLD int extension_tune(KOOP(rls) *rls, real s, KOOP(step) *step, int *frozen) {
	const KOOP(extension) *own = rls->config.regulator->extension;
	int status = KOOP_OK;
	if (own->adjust) { status = own->adjust(rls, s, step); }
	*frozen = !step->update_covariance;
	return status;
}

/* What a sample leaves to be done once P has changed by its step. */
typedef struct KOOP(rest) {
	real bound; /* of the new Theta's elements */
	int theta;  /* Theta changes */
	int any;    /* the step changes something */
} KOOP(rest);

/* The weight goes into the gain: of a product of three, the two layouts of Theta's loops would round differently.
 * With a negative noise, the gain has the sign of noise + s. Out of line: the frame is gone when P is reshaped, which
 * takes the deepest stack. */
static OUT_OF_LINE COLD int extension_step(KOOP(rls) *rls, real innovation, int *frozen, KOOP(rest) *rest) {
	KOOP(step) step;
	extension_keep(rls);
	const int status = change_p(rls, 1, innovation, &step, frozen, &rest->bound);
	rest->theta = step.update_theta;
	rest->any = changes_model(&step);
	if (status != KOOP_OK || !rest->any) { return status; }
	scaled(rls->gain, step.noise < 0 ? -step.weight : step.weight, rls->gain, rls->n_regressors_padded);
	return KOOP_OK;
}

/* Theta's change, which comes later, still needs the gain, and the gate needs zeta; they are neighbours. Out of line,
 * as extension_step(). */
static OUT_OF_LINE COLD void keep_vectors(KOOP(rls) *rls) {
	copy(undo_of(rls) + rls->n_undo, rls->zeta, 2 * rls->n_regressors_padded);
}

static OUT_OF_LINE COLD void return_vectors(KOOP(rls) *rls) {
	copy(rls->zeta, undo_of(rls) + rls->n_undo, 2 * rls->n_regressors_padded);
}

static COLD int extension_reshape(KOOP(rls) *rls) {
	if (!rls->config.regulator->extension->reshape) { return KOOP_OK; }
	keep_vectors(rls);
	const int status = rls->config.regulator->extension->reshape(rls);
	return_vectors(rls);
	return status;
}

static OUT_OF_LINE COLD int extension_finish(KOOP(rls) *rls, const KOOP(rest) *rest, int status) {
	if (status == KOOP_OK && rest->any) { change_theta(rls, rest->theta, 1, rest->bound); }
	if (status != KOOP_OK) { extension_undo(rls); }
	seal(rls); /* the memory can change where the model does not */
	return status;
}

static COLD int extension_attend(KOOP(rls) *rls, real innovation, int *frozen) {
	KOOP(rest) rest;
	int status = extension_step(rls, innovation, frozen, &rest);
	if (status == KOOP_OK && rest.any) { status = extension_reshape(rls); }
	return extension_finish(rls, &rest, status);
}

const KOOP(engine) KOOP(reg_engine) = {extension_size, extension_restart, extension_attend};

/* ---- Further changes of P --------------------------------------------------------- */

/* Changes P by K in rls->gain, as one step does. In line: a frame less where the stack is deepest. */
static INLINE int change_covariance(KOOP(rls) *rls, real noise, real scale, real denominator, real inverse) {
	const KOOP(step) step = {noise, scale, 0, 0, 0, 0, 0, 1};
	if (!(MATH(fabs)(denominator) < REAL_MAX / 4)) { return KOOP_E_OVERFLOW; }
	rls->gain_square = scaled_dot(rls->gain, inverse, rls->gain, rls->n_regressors_padded);
	return is_finite(rls->gain_square) ? rls->config.form->apply(rls, &step, denominator) : KOOP_E_OVERFLOW;
}

static COLD int change_check(const KOOP(rls) *rls, const real *v, real a) {
	if (!rls || !rls->theta || !v) { return KOOP_E_NULL; }
	if (!(a > 0 && 1 / a < REAL_MAX / 4)) { return KOOP_E_RANGE; }
	return all_finite(v, rls->n_regressors) ? KOOP_OK : KOOP_E_INPUT;
}

COLD int KOOP(rls_add_information)(KOOP(rls) *rls, const real *v, real a) {
	const int status = change_check(rls, v, a);
	if (status != KOOP_OK) { return status; }
	copy(rls->zeta, v, rls->n_regressors);
	const real denominator = 1 / a + rls->config.form->gain(rls);
	return change_covariance(rls, 1 / a, 1, denominator, 1 / denominator);
}

COLD int KOOP(rls_add_covariance)(KOOP(rls) *rls, const real *v, real a) {
	const int status = change_check(rls, v, a);
	if (status != KOOP_OK) { return status; }
	for (size_t i = 0; i < rls->n_regressors_padded; i++) { rls->gain[i] = 0; }
	copy(rls->gain, v, rls->n_regressors);
	return change_covariance(rls, -a, 1, -a, 1);
}

COLD int KOOP(rls_scale_covariance)(KOOP(rls) *rls, real factor) {
	if (!rls || !rls->theta) { return KOOP_E_NULL; }
	if (!(factor > 0 && factor < REAL_MAX / 4)) { return KOOP_E_RANGE; }
	for (size_t i = 0; i < rls->n_regressors_padded; i++) { rls->zeta[i] = 0; }
	(void)rls->config.form->gain(rls); /* 0, and so is what the form has worked out for apply() */
	const KOOP(step) step = {1, factor, 0, 0, 0, 0, 0, 1};
	rls->gain_square = 0;
	return rls->config.form->apply(rls, &step, 1);
}
